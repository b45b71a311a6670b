"""Help of commands in groups, with option values, defaults and examples, nothing cut."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from typer.core import TyperCommand, TyperGroup

GROUPS: Mapping[str, tuple[str, ...]] = {
    "Start": ("init", "check", "explain", "schema"),
    "Plan": ("plan", "sweep", "why", "report", "export"),
    "Judge": ("verify", "score"),
    "Compare": ("compare", "platform", "curve", "solvers"),
    "Robot": ("robot", "calibrate"),
}
"""Commands by group, in the order of the help."""
EXAMPLES: Mapping[str, str] = {
    "": "init demo; plan demo/tasks.yaml --open; robot import robot.urdf",
    "init": "demo; demo --robot yumi; demo --robot my_robot.urdf",
    "check": "tasks.yaml; cell.yaml tasks.yaml; tasks.yaml --json",
    "explain": "; E610; E620 --json",
    "schema": "; tasks; tasks --out tasks.schema.json",
    "plan": "tasks.yaml --open; 04_packing --effort quick -v; tasks.yaml --watch",
    "sweep": "study.yaml; study.yaml --out study --pages study; study.yaml --optimise",
    "why": "plan; plan --budget '30 s'; plan --apply faster",
    "report": "plan --open; plan/schedule.json; plan --tasks tasks.yaml",
    "export": "plan --to ros2; plan --to csv --rate 500; plan --to gltf --out cell",
    "verify": "plan; plan --tasks tasks.yaml -v; log.csv --plan plan",
    "score": "'cells/**/tasks.yaml'; tasks.yaml --baseline b.json --update-baseline; tasks.yaml --baseline b.json",
    "compare solvers": "tasks.yaml; 04_packing --effort quick; tasks.yaml --method fixed --method exact --out both",
    "compare schedules": "before after; before after --out both --page; a b --json",
    "platform": "; tasks.yaml --stage 2; --angle '20 deg' --plot move.png",
    "curve": "10_seam; tasks.yaml --step '10 ms'; tasks.yaml --task weld --out curve.csv",
    "solvers": "; --json",
    "robot list": "; --json",
    "robot show": "sda10f; robot/robot.yaml -v; yumi --json",
    "robot export": "yumi --out yumi.urdf; robot/robot.yaml --out -",
    "robot import": "robot.urdf; robot.urdf --srdf robot.srdf --out robot; --left arm.urdf --right arm.urdf --out pair",
    "robot reach": "sda10f; cell.yaml --out reach.png; cell.yaml --height '0.9 m'; cell.yaml --handover '80 mm'",
    "calibrate": "points.yaml; points.yaml --out base.yaml; points.yaml --fit tool",
}
"""Examples of commands: what follows their names, with semicolons between; tested."""


class HelpCommand(TyperCommand):
    """Command with values, defaults and examples in its help."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """List the words of the usage line."""
        arguments = [p for p in self.get_params(ctx) if p.param_type_name == "argument"]
        return ["[OPTIONS]", *(_argument(argument) for argument in arguments)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, options and examples."""
        shown = [p for p in self.get_params(ctx) if not getattr(p, "hidden", False)]
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            rows = [_row(param, ctx) for param in shown if param.param_type_name == kind]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
        _write_examples(ctx.command_path, formatter)


class HelpGroup(TyperGroup):
    """Group with its commands in groups, each with the first sentence of its help."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write options and commands."""
        with formatter.section("Options"):
            formatter.write_dl([_row(param, ctx) for param in self.get_params(ctx)])
        groups = GROUPS if "plan" in self.commands else {"Commands": tuple(self.commands)}
        for title, names in groups.items():
            commands = {name: self.commands[name] for name in names if name in self.commands}
            rows = [(name, _first_sentence(command.help)) for name, command in commands.items()]
            with formatter.section(title):
                formatter.write_dl(rows)
        _write_examples(ctx.command_path, formatter)


def _write_examples(path: str, formatter: Any) -> None:
    if examples := EXAMPLES.get(path.partition(" ")[2]):
        with formatter.section("Examples"):
            for words in examples.split("; "):
                formatter.write(f"  {path} {words}".rstrip() + "\n")


def _first_sentence(text: str | None) -> str:
    return " ".join((text or "").split("\n\n")[0].split())


def _argument(argument: Any) -> str:
    name = (argument.metavar or argument.name.upper()).removesuffix("...")
    name += "..." * (argument.nargs != 1)
    return name if argument.required else f"[{name}]"


def _row(param: Any, ctx: Any) -> tuple[str, str]:
    """Describe an argument or option: its names and value, its meaning and default."""
    if param.param_type_name == "argument":
        return _argument(param), param.help or ""
    names, text = param.get_help_record(ctx)
    kinds = {"str": "TEXT", "int": "N", "int range": "N", "float": "NUMBER"}
    kinds |= {"path": "PATH", "Path": "PATH"}
    names = re.sub(r"<(?:list\[)?([^\]>]+)\]?>", lambda kind: kinds.get(kind[1], kind[1]), names)
    text = re.sub(r"  \[(required|[0-9.<=x]+)\]$", "", text)
    return names, re.sub(r"\[default: \(?(.*?)\)?(; [0-9.<=x]+)?\]$", r"[default: \1]", text)
