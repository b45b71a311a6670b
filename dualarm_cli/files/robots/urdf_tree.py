"""XML parser for URDF and COLLADA: a tree with line numbers, without entities."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import field
from xml.parsers import expat

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.text_source import TextSource, quote
from dualarm_cli.records import dataclass

MAX_ELEMENTS = 50_000
"""Maximum number of elements in one URDF."""
MAX_DEPTH = 40
"""Maximum nesting depth of elements."""
MAX_MAGNITUDE = 1e9
"""Largest absolute number in a URDF."""
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", re.ASCII)


@dataclass
class Element:
    """Element of an XML tree."""

    tag: str
    """Tag name."""
    attributes: dict[str, str]
    """Attributes by name."""
    line: int = 0
    """Line of the start tag."""
    column: int = 0
    """Column of the start tag."""
    children: list[Element] = field(default_factory=list)
    """Child elements."""
    text: str = ""
    """Text of the element without that of its children."""

    def find(self, tag: str) -> Element | None:
        """Find the first child with a tag."""
        return next(self.all(tag), None)

    def all(self, tag: str) -> Iterator[Element]:
        """Iterate over the children with a tag."""
        return (child for child in self.children if child.tag == tag)

    def get(self, name: str, default: str = "") -> str:
        """Look up an attribute."""
        return self.attributes.get(name, default)

    @property
    def name(self) -> str:
        """Value of the `name` attribute."""
        return self.get("name")

    def child_name(self, tag: str, attribute: str) -> str:
        """Look up an attribute of the first child with a tag, or ""."""
        child = self.find(tag)
        return child.get(attribute) if child else ""


class UrdfFindings:
    """Everything wrong with one URDF."""

    def __init__(self, source: TextSource) -> None:
        """Start without findings."""
        self.source = source
        self.diagnostics: list[Diagnostic] = []

    def add(self, element: Element, message: str) -> None:
        """Add a finding at an element."""
        self.diagnostics.append(
            self.source.diagnostic(element.line, element.column, "E400", message)
        )

    def raise_if_any(self) -> None:
        """Raise all findings, by line.

        Raises:
            InputError: something was found.
        """
        if self.diagnostics:
            raise InputError(sorted(self.diagnostics, key=lambda d: (d.line, d.column)))

    def numbers(
        self, element: Element, attribute: str, count: int, what: str
    ) -> list[float] | None:
        """Parse the numbers of an attribute, or None after noting errors.

        Args:
            element: the element.
            attribute: its attribute.
            count: how many numbers there must be.
            what: the element in words.
        """
        text = element.get(attribute)
        words = text.split()
        if len(words) != count:
            wanted = "a number" if count == 1 else f"{count} numbers"
            given = quote(text) if attribute in element.attributes else "nothing"
            self.add(element, f"{what}: {attribute} must be {wanted}, not {given}")
            return None
        for word in words:
            if not _NUMBER.fullmatch(word) or len(word) > 40:
                comma = "; write a decimal point" if re.fullmatch(r"[-+]?\d+,\d+", word) else ""
                self.add(
                    element,
                    f"{what}: {attribute} holds {quote(word)}, which is not a finite number{comma}",
                )
                return None
        values = [float(word) + 0.0 for word in words]
        bad = next((v for v in values if not math.isfinite(v) or abs(v) > MAX_MAGNITUDE), None)
        if bad is not None:
            self.add(
                element, f"{what}: {attribute} holds {bad:g}; at most {MAX_MAGNITUDE:g} is allowed"
            )
            return None
        return values


def parse_xml(source: TextSource) -> Element:
    """Parse the root element of an XML text.

    Args:
        source: the text of one file.

    Raises:
        InputError: not XML, a DOCTYPE or entity, or larger or deeper than the limits.
    """
    parser = expat.ParserCreate()
    root: list[Element] = []
    stack: list[Element] = []
    count = 0

    def fail(message: str, code: str = "E400") -> InputError:
        line, column = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1
        return InputError([source.diagnostic(line, column, code, message)])

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS or len(stack) >= MAX_DEPTH:
            limits = f"{MAX_ELEMENTS} elements, {MAX_DEPTH} deep"
            raise fail(f"exceeds the limits of XML files ({limits})", "E100")
        element = Element(tag, attributes, parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)
        (stack[-1].children if stack else root).append(element)
        stack.append(element)
        texts.append([])

    def refuse(*_: object) -> None:
        raise fail("a DOCTYPE or entity is not allowed; remove it")

    texts: list[list[str]] = []

    def end(_tag: str) -> None:
        stack.pop().text = "".join(texts.pop())

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = lambda text: texts[-1].append(text)
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(source.text, True)
    except expat.ExpatError as error:
        if not source.text.strip():
            raise InputError(
                [Diagnostic(source.name, 0, 0, "E400", "is empty; a URDF is required")]
            ) from None
        reason = expat.ErrorString(error.code)
        diagnostic = source.diagnostic(error.lineno, error.offset + 1, "E400", f"not XML: {reason}")
        raise InputError([diagnostic]) from None
    return root[0]
