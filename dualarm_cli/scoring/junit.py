"""Score as JUnit XML for CI servers.

The file has `testsuites`, `testsuite`, `testcase`, `failure`, `error` and `system-out` with common attributes. It has
no times, because they would differ from run to run.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree import ElementTree

from dualarm_cli.model.verification import exceptions
from dualarm_cli.scoring.messages import figure_words
from dualarm_cli.scoring.verdict import EXIT_CODES, Verdict, words

SUITE = "dualarm score"
MARK = b"<?xml version='1.0' encoding='UTF-8'?>\n<testsuites name=\"dualarm score\""
"""First bytes of a file that this package wrote."""
_NO_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot represent."""


def junit_bytes(verdicts: Sequence[Verdict]) -> bytes:
    """Encode a score as JUnit XML with a test case per task file.

    A failed gate is a failure; a case without a valid evaluation is an error.

    Args:
        verdicts: by name.
    """
    failures = [v for v in verdicts if v.failed and not _is_error(v)]
    errors = [v for v in verdicts if _is_error(v)]
    counts = {
        "tests": str(len(verdicts)),
        "failures": str(len(failures)),
        "errors": str(len(errors)),
    }
    suites = ElementTree.Element("testsuites", {"name": SUITE, **counts})
    suite = ElementTree.SubElement(suites, "testsuite", {"name": SUITE, **counts, "skipped": "0"})
    for verdict in verdicts:
        _add_case(suite, verdict)
    ElementTree.indent(suites)
    body: bytes = ElementTree.tostring(suites, encoding="UTF-8", xml_declaration=True)
    return body + b"\n"


def _is_error(verdict: Verdict) -> bool:
    return EXIT_CODES[verdict.state] in (2, 4) or verdict.state == "timed_out"


def _add_case(suite: ElementTree.Element, verdict: Verdict) -> None:
    name = xml_text(verdict.case)
    folder, _, _ = name.rpartition("/")
    case = ElementTree.SubElement(
        suite, "testcase", {"name": name, "classname": folder.replace("/", ".") or SUITE}
    )
    if verdict.failed:
        tag = "error" if _is_error(verdict) else "failure"
        lines = [xml_text(str(reason)) for reason in verdict.reasons]
        message = lines[0] if lines else words(verdict.state)
        problem = ElementTree.SubElement(case, tag, {"type": verdict.state, "message": message})
        problem.text = "\n".join(lines)
    if verdict.evaluation is None or verdict.evaluation.cycle_time is None:
        return
    time, change, gap, clearance = figure_words(verdict)
    state = f"{words(verdict.state)}{exceptions(verdict.caveats)}"
    figures = f"cycle time {time} s, change {change}, {gap} above bound, clearance {clearance} mm: {state}"
    ElementTree.SubElement(case, "system-out").text = xml_text(figures)


def xml_text(text: str) -> str:
    """Replace characters that XML cannot represent by their escapes."""
    return _NO_XML.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)
