"""Papers, as BibTeX entries."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Paper:
    key: str  # of the BibTeX entry
    title: str
    authors: str  # separated by " and "
    year: int
    journal: str = ""
    conference: str = ""
    arxiv: str = ""

    def bibtex(self) -> str:
        """The entry, whose capitals a bibliography's style keeps."""
        fields = {"title": f"{{{self.title}}}", "author": self.authors, "year": str(self.year)}
        kind = "misc"
        if self.journal:
            kind, fields["journal"] = "article", self.journal
        if self.conference:
            kind, fields["booktitle"] = "inproceedings", self.conference
        if self.arxiv:
            fields |= {"eprint": self.arxiv, "archiveprefix": "arXiv"}
        body = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
        return f"@{kind}{{{self.key},\n{body}\n}}\n"


SBI = Paper(  # the library that learns posteriors
    "tejerocantero2020sbi",
    "sbi: A toolkit for simulation-based inference",
    "Tejero-Cantero, Alvaro and Boelts, Jan and Deistler, Michael and Lueckmann, Jan-Matthis and "
    "Durkan, Conor and Gonçalves, Pedro J. and Greenberg, David S. and Macke, Jakob H.",
    2020,
    journal="Journal of Open Source Software",
    arxiv="2007.09114",
)
