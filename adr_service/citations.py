"""Papers, as BibTeX entries."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Paper:
    key: str  # of the BibTeX entry
    title: str
    authors: str  # separated by " and "
    year: int
    venue: str = ""
    arxiv: str = ""

    def bibtex(self) -> str:
        """The entry, whose capitals a bibliography's style keeps."""
        fields = {"title": f"{{{self.title}}}", "author": self.authors, "year": str(self.year)}
        if self.venue:
            fields["journal"] = self.venue
        if self.arxiv:
            fields |= {"eprint": self.arxiv, "archiveprefix": "arXiv"}
        body = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
        kind = "article" if self.venue else "misc"
        return f"@{kind}{{{self.key},\n{body}\n}}\n"
