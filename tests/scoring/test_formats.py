"""A score in the formats of CI: JUnit by a schema, GitHub's commands and Markdown escaped, JSON without the clock."""

from __future__ import annotations

import io
import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
import xmlschema
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from dualarm_cli.model.studies.evaluation import Finding
from dualarm_cli.scoring.document import score_document
from dualarm_cli.scoring.index import score_index
from dualarm_cli.scoring.junit import MARK, junit_bytes, xml_text
from dualarm_cli.scoring.markdown import MARK as MARKDOWN_MARK
from dualarm_cli.scoring.markdown import MOST, github_commands, markdown_text
from dualarm_cli.scoring.messages import caveat_lines, score_table
from dualarm_cli.scoring.verdict import EXIT_CODES, STATES, Verdict

EVIL = "cells/\x1b[31m\x00]]> <&\"'\ufffe\ud800 a|b`@user`\r\n::error::x/tasks.yaml"
SCHEMA = xmlschema.XMLSchema(Path(__file__).with_name("junit.xsd"))


@pytest.fixture
def verdicts(evaluation):
    """One case of every state, with names and messages that mean to do harm."""
    return [
        Verdict(
            f"{EVIL}{state}",
            state,
            None if state == "missing" else evaluation(f"{EVIL}{state}"),
            None,
            (Finding(f"{state}: {EVIL}", EVIL, 3, 7),) if EXIT_CODES[state] else (),
        )
        for state in STATES
    ]


def test_junit_is_valid_by_its_schema_whatever_names_hold(verdicts):
    """Each failing case has one failure or error; counts are what they count."""
    data = junit_bytes(verdicts)
    SCHEMA.validate(data.decode())
    suite = ElementTree.fromstring(data)[0]
    assert len(suite) == len(STATES) == int(suite.get("tests"))
    for tag, number in (("failure", "failures"), ("error", "errors")):
        assert len(suite.findall(f"testcase/{tag}")) == int(suite.get(number)) > 0
    failing = sum(code != 0 for code in EXIT_CODES.values())
    assert int(suite.get("failures")) + int(suite.get("errors")) == failing
    assert data.startswith(MARK)
    # Figures of cases that have none would be dashes only.
    silent = [case.get("name") for case in suite if case.find("system-out") is None]
    assert [name.rpartition("tasks.yaml")[2] for name in silent] == ["missing"]


def test_the_schema_itself_finds_mistakes(verdicts):
    """A schema that accepts anything would prove nothing."""
    text = junit_bytes(verdicts).decode()
    for old, new in (("classname=", "class="), ("<failure ", "<failed "), ('tests="13"', "")):
        assert old in text
        broken = text.replace(old, new).replace("</failure>", f"</{new[1:-1] or 'failure'}>")
        with pytest.raises((xmlschema.XMLSchemaException, ElementTree.ParseError)):
            SCHEMA.validate(broken)


@given(st.text(alphabet=st.characters(min_codepoint=0, max_codepoint=0x10FFFF), max_size=20))
def test_any_text_can_be_written_as_xml(text):
    """Well-formed, and what XML can hold comes back as it was."""
    element = ElementTree.Element("a", {"b": xml_text(text)})
    back = ElementTree.fromstring(ElementTree.tostring(element, encoding="UTF-8")).get("b")
    if all(
        c in "\t\n\r" or (c >= " " and not "\ud800" <= c <= "\udfff" and c not in "\ufffe\uffff")
        for c in text
    ):
        assert back == text
    else:
        assert "\\" in back


def test_what_a_pass_leaves_open_is_in_every_format(evaluation):
    """One of two cells has a tool without a shape: no format shows it as simply good, and the gate stays open."""
    caveat = "collisions could not be fully checked: no shapes of left_tool"
    names = ("cells/a/tasks.yaml", "cells/b/tasks.yaml")
    found = evaluation(names[0], caveats=(caveat,)), evaluation(names[1])
    verdicts = [Verdict(one.case, "pass", one, None, ()) for one in found]
    document = score_document(verdicts, {}, 0.0, None)
    assert document["exit_code"] == 0
    assert [case["caveats"] for case in document["cases"]] == [[caveat], []]
    cases = ElementTree.fromstring(junit_bytes(verdicts))[0]
    texts = [case.find("system-out").text for case in cases]
    assert [text.endswith(f": pass, except that {caveat}") for text in texts] == [True, False]
    text = markdown_text(verdicts, 0.0, compared=False)
    assert "all cells are good" not in text
    assert "no cell fails, 1 not fully checked" in text
    assert "- cells/a/tasks.yaml: verified, except that collisions" in text
    [warning] = github_commands(verdicts, None)
    assert warning.startswith("::warning::dualarm score: cells/a/tasks.yaml: verified, except that")
    index = score_index(verdicts, {}, 0.0, compared=False).decode()
    assert index.count('<td class="warn">pass, not fully checked</td>') == 1
    assert index.count('<td class="warn">not fully</td>') == 1
    assert index.count('<td class="good">yes</td>') == 1
    console = Console(width=160, file=io.StringIO(), force_terminal=True, color_system="standard")
    console.print(score_table(verdicts))
    shown = console.file.getvalue()
    assert "\x1b[33mpass, not fully checked\x1b[0m" in shown
    assert "\x1b[32mpass\x1b[0m" in shown
    failing = Verdict(names[0], "regressed", found[0], None, ())
    assert failing.caveats == ()
    together = [*verdicts, Verdict("c", "pass", evaluation("c", caveats=(caveat,)), None, ())]
    assert caveat_lines(together) == [f"{names[0]}, c: verified, except that {caveat}"]


def test_github_commands_are_one_line_each_and_escaped(verdicts):
    """No message ends a command or begins another one; properties hold no colon and no comma of their own."""
    lines = github_commands(verdicts[:3], None)
    assert len(lines) == 3
    for line in lines:
        assert "\n" not in line
        assert "\r" not in line
        assert "\x1b" not in line
        _, properties, message = line.split("::", 2)
        assert properties.startswith("error file=")
        named = dict(entry.split("=", 1) for entry in properties.removeprefix("error ").split(","))
        assert named["line"] == "3"
        assert named["col"] == "7"
        assert ":" not in properties
        assert message


def test_github_is_told_the_percent_and_the_place_from_the_workspace(
    evaluation, tmp_path, monkeypatch
):
    """% is escaped; files are named from the repository's folder; a case without a line is at its first one."""
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path / "sub")
    one = Verdict("a.yaml", "regressed", evaluation("a.yaml"), None, (Finding("+5 %", "a.yaml"),))
    assert github_commands([one], str(tmp_path)) == [
        "::error file=sub/a.yaml,line=1,title=a.yaml%3A regressed::+5 %25"
    ]
    assert github_commands([one], None)[0].startswith("::error file=a.yaml,")


def test_github_gets_no_more_annotations_than_it_shows(evaluation):
    """The last one says how many more there are."""
    many = [
        Verdict(f"{k}", "crashed", None, None, (Finding("x", f"{k}"),)) for k in range(MOST + 5)
    ]
    lines = github_commands(many, None)
    assert len(lines) == MOST
    assert "6 more findings" in lines[-1]
    assert len(github_commands(many[:MOST], None)) == MOST


def test_markdown_has_a_row_for_each_case_and_no_markup_of_theirs(verdicts):
    """Pipes, HTML and mentions in names are plain text."""
    text = markdown_text(verdicts, 0.02, True)
    assert text.startswith(MARKDOWN_MARK)
    body = text.removeprefix(MARKDOWN_MARK)
    rows = [line for line in body.splitlines() if line.startswith("| cells/")]
    assert len(rows) == len(STATES)
    for row in rows:
        assert row.replace("\\|", "").count("|") == 7
    assert "<" not in body
    assert "@" not in body
    assert "\x1b" not in body
    assert "9 of 13 cells fail" in body
    assert "2 % longer" in body


def test_json_has_every_case_and_no_clock(verdicts):
    """One document that any reader takes; control characters spelt out."""
    document = score_document(verdicts, {"effort": "quick"}, 0.02, "scores.json")
    text = json.dumps(document, allow_nan=False).encode()
    assert json.loads(text) == document
    assert document["exit_code"] == 4
    assert not document["passed"]
    assert [row["state"] for row in document["cases"]] == list(STATES)
    assert sum(document["counts"].values()) == len(STATES)
    for word in (b"seconds", b"wall", b"known", b"\\u0000", b"\\u001b"):
        assert word not in text
