"""A report read as a browser would: its elements, texts and what they refer to."""

import re
from html.parser import HTMLParser
from pathlib import Path

VOID = {"meta", "link", "img", "br", "hr", "wbr"}
FROM_OUTSIDE = ("src", "href", "srcset", "action", "data", "poster", "background")


class Element:
    """An element with its attributes, what lies in it, and its text."""

    def __init__(self, name: str, attributes: dict[str, str]):
        self.name, self.attributes, self.children = name, attributes, []

    @property
    def text(self) -> str:
        """All text below, spaces and line breaks as one space."""
        return re.sub(r"[ \n]+", " ", "".join(self._texts())).strip()

    def _texts(self):
        for child in self.children:
            yield from [child] if isinstance(child, str) else child._texts()

    def all(self, name: str, **attributes: str) -> list["Element"]:
        """Elements below of a name and with these attributes ("class_" for class)."""
        wanted = {key.rstrip("_"): value for key, value in attributes.items()}
        found = []
        for child in self.children:
            if isinstance(child, Element):
                if child.name == name and wanted.items() <= child.attributes.items():
                    found.append(child)
                found += child.all(name, **attributes)
        return found

    def one(self, name: str, **attributes: str) -> "Element":
        """The only such element."""
        (found,) = self.all(name, **attributes)
        return found


class _Reader(HTMLParser):
    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.open = [Element("document", {})]

    def handle_starttag(self, tag, attrs):
        element = Element(tag, dict(attrs))
        assert len(element.attributes) == len(attrs), f"{tag}: an attribute twice"
        self.open[-1].children.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag):
        assert tag not in VOID and self.open[-1].name == tag, f"</{tag}> ends <{self.open[-1].name}>"
        self.open.pop()

    def handle_data(self, data):
        self.open[-1].children.append(data)


def read_page(path: Path) -> Element:
    """A page's document; fails unless every element is closed, in order, and nothing is asked for from outside
    but pages that are there."""
    reader = _Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    reader.close()
    (document,) = reader.open
    _check(document, path.parent)
    return document


def _check(document: Element, folder: Path) -> None:
    elements = list(_below(document))
    ids = [element.attributes["id"] for element in elements if "id" in element.attributes]
    assert len(ids) == len(set(ids)), "an id twice"
    for element in elements:
        for key in FROM_OUTSIDE:
            if key in element.attributes and (element.name, key) != ("data", "data"):
                value = element.attributes[key]
                if value.startswith("data:") or (element.name == "a" and (folder / value).is_file()):
                    continue
                assert value[0] == "#" and value[1:] in ids, (element.name, key, value[:80])
        for key in ("aria-labelledby",):
            assert element.attributes.get(key, ids[0]) in ids
        assert element.name not in ("script", "iframe", "object", "embed", "form")
        assert not any(key.startswith("on") for key in element.attributes)
    style = "".join(element.text for element in elements if element.name == "style")
    assert style and "url(" not in style and "@import" not in style
    assert (
        document.one("meta", **{"http-equiv": "Content-Security-Policy"})
        .attributes["content"]
        .startswith("default-src 'none'")
    )


def _below(element: Element):
    for child in element.children:
        if isinstance(child, Element):
            yield child
            yield from _below(child)


def rows_of(document: Element, anchor: str) -> list[list[Element]]:
    """Cells of the rows of a table, by the anchor of its section."""
    body = document.one("section", id=anchor).one("tbody")
    return [row.all("th") + row.all("td") for row in body.all("tr")]


def value_of(cell: Element) -> float:
    """The number that a cell rounds."""
    return float(cell.one("data").attributes["value"])
