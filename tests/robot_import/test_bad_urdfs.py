"""Bad URDFs: `dualarm robot import` ends with 2 and a sentence at their line, reads nothing else and writes nothing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dualarm_cli.cli.run import run

LIMIT = '<limit lower="-1" upper="1" velocity="1"/>'
SOLID = "<collision><geometry>{}</geometry></collision>"


def chain(count: int, axis: str = "0 0 1", limit: str = LIMIT, origin: str = "") -> str:
    """Returns links and joints in a row."""
    links = "\n".join(f'<link name="l{k}"/>' for k in range(count + 1))
    joints = "\n".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>{origin}'
        f'<axis xyz="{axis}"/>{limit}</joint>'
        for k in range(count)
    )
    return links + joints


def robot(content: str, before: str = "") -> str:
    return f'{before}<robot name="r">\n{content}</robot>'


def with_solid(geometry: str) -> str:
    """Returns a robot with a shape on its second link."""
    solid = f'<link name="l1">{SOLID.format(geometry)}</link>'
    return robot(chain(6).replace('<link name="l1"/>', solid))


def entities(count: int) -> str:
    """Returns entities each of which is the one before ten times."""
    rows = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 10}">' for k in range(count))
    return f'<!DOCTYPE robot [<!ENTITY e0 "aaaaaaaaaa">{rows}]>'


BAD = {
    "entity bomb": (robot("&e9;" + chain(6), entities(9)), "DOCTYPE or entity is not allowed"),
    "external entity": (
        robot("&x;" + chain(6), '<!DOCTYPE robot [<!ENTITY x SYSTEM "secret.txt">]>'),
        "DOCTYPE or entity is not allowed",
    ),
    "loop": (
        robot(
            '<link name="a"/><link name="b"/>'
            '<joint name="x" type="fixed"><parent link="a"/><child link="b"/></joint>'
            '<joint name="y" type="fixed"><parent link="b"/><child link="a"/></joint>'
        ),
        "cycle through link 'a'",
    ),
    "zero axis": (robot(chain(6, axis="0 0 0")), "axis must not be zero"),
    "axis that is no number": (robot(chain(6, axis="nan 0 0")), "'nan', which is not a finite"),
    "endless origin": (robot(chain(6, origin='<origin xyz="0 inf 0"/>')), "'inf', which is not"),
    "limit that is no number": (
        robot(chain(6, limit='<limit lower="nan" upper="1" velocity="1"/>')),
        "lower holds 'nan'",
    ),
    "negative speed": (
        robot(chain(6, limit='<limit lower="-1" upper="1" velocity="-1"/>')),
        "velocity limit must be above 0, not -1",
    ),
    "limits swapped": (
        robot(chain(6, limit='<limit lower="1" upper="-1" velocity="1"/>')),
        "lower limit 1 is above upper limit -1",
    ),
    "50,000 joints": (robot(chain(50_000)), "exceeds the limits of XML files"),
    "too few joints": (robot(chain(5)), "no row of 6 joints or more"),
    "no XML": ("{}", "not XML"),
    "empty": ("", "is empty"),
    "mesh out of the project": (
        with_solid('<mesh filename="../../../secret.stl"/>'),
        "leaves the project folder",
    ),
    "mesh by its absolute path": (
        with_solid('<mesh filename="/secret.stl"/>'),
        "there is no file",
    ),
    "mesh out of its package": (
        with_solid('<mesh filename="package://inner/../../secret.stl"/>'),
        "must be package://name/path",
    ),
    "mesh of a package above": (
        with_solid('<mesh filename="package://../secret.stl"/>'),
        "must be package://name/path",
    ),
    "mesh by an absolute path in a package": (
        with_solid('<mesh filename="package://inner//etc/hostname"/>'),
        "must be package://name/path",
    ),
    "mesh by an absolute path behind three slashes": (
        with_solid('<mesh filename="package:///etc/hostname"/>'),
        "package 'etc' is not in the folder",
    ),
    "mesh by an absolute path behind four slashes": (
        with_solid('<mesh filename="package:////etc/hostname"/>'),
        "must be package://name/path",
    ),
    "mesh of a folder that is no package": (
        with_solid('<mesh filename="package://aside/secret.stl"/>'),
        "package 'aside' is not in the folder",
    ),
    "mesh that is missing": (with_solid('<mesh filename="none.stl"/>'), "there is no file"),
    "box without end": (with_solid('<box size="inf 1 1"/>'), "'inf', which is not a finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_urdfs_are_refused_in_a_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A word that stands in files around the project is nowhere in what is told."""
    text, message = BAD[name]
    folder = tmp_path / "outer" / "project" / "inner"
    folder.mkdir(parents=True)
    (tmp_path / "aside").mkdir()
    for place in (tmp_path, tmp_path / "aside", tmp_path / "outer", folder):
        (place / "secret.txt").write_text("PASSPHRASE")
        (place / "secret.stl").write_text("solid PASSPHRASE\nendsolid\n")
    monkeypatch.chdir(folder)
    (folder / "bad.urdf").write_text(text)
    before = sorted(tmp_path.rglob("*"))
    assert run(["robot", "import", "bad.urdf", "--out", "mine"]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert "Traceback" not in told
    assert "PASSPHRASE" not in told
    assert sorted(tmp_path.rglob("*")) == before
    place = r"error(\[E\d+\])?: bad\.urdf:" if "row of 6" not in message else ""
    assert re.match(place, told)
