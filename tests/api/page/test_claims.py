"""The page of the paper's claims."""

from fastapi import Request

from api.page.rendering import show


def page_of(findings):
    """The page with one report."""
    request = Request({"type": "http", "method": "GET", "path": "/claims", "headers": []})
    report = {"preset": "quick", "changed": {"iterations": 2}, "findings": findings}
    return show(request, "claims.html", claims=[report]).body.decode()


def finding(claim, *evidence):
    verdict = "supported" if evidence else "not measured"
    words = {"claim": claim, "statement": f"statement {claim}", "seeds_needed": None}
    return {**words, "verdict": verdict, "evidence": list(evidence)}


def test_claims_without_evidence_are_folded_and_counted():
    page = page_of([finding("V1", "dropo 1.02"), finding("V2"), finding("V3")])
    shown, folded = page.split("<details>")
    assert "dropo 1.02" in shown
    assert "V2</td>" not in page
    assert "2 of 3 claims have no evidence under the budget quick, iterations = 2" in shown
    assert "V3: statement V3" in folded


def test_without_any_evidence_there_is_no_table():
    page = page_of([finding("V1")])
    assert "<table>" not in page
    assert "1 of 1 claims" in page


def test_nothing_is_folded_where_every_claim_has_evidence():
    assert "<details>" not in page_of([finding("V1", "dropo 1.02")])
