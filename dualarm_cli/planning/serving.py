"""Which methods serve a robot, and which ones are taken where nobody named any."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings

CLOSED_FORMS, NUMERIC = "arm_angle", "numeric"
"""Redundancy solvers: of arms with closed forms, and of any others."""
SAMPLED = "sampled"
"""The method that plans whole sequences of arms without closed forms."""


def served_settings(settings: PlanSettings, model: CellModel) -> tuple[PlanSettings, list[str]]:
    """Returns settings that serve a robot, and what was taken in place of the defaults.

    Only what nobody named is replaced: a solver that was asked for and does not serve has its reason told.

    Args:
        settings: as they were asked for.
        model: the job's cell.
    """
    if not model.without_closed_form:
        return settings, []
    default, words = PlanSettings(), ""
    found = settings
    if "platform" not in settings.named and settings.platform == default.platform:
        found, words = replace(found, platform=SAMPLED), f" --platform {SAMPLED}"
    if "redundancy" not in settings.named and settings.redundancy == default.redundancy:
        found, words = replace(found, redundancy=NUMERIC), f"{words} --redundancy {NUMERIC}"
    if not words:
        return settings, []
    note = f"solvers: {_which(model)} not spherical-revolute-spherical; planned with{words}"
    return found, [note]


def why_no_closed_form(model: CellModel) -> str | None:
    """Returns why nothing that needs closed forms serves a robot, or None."""
    if not model.without_closed_form:
        return None
    return (
        f"{_which(model)} not spherical-revolute-spherical: --platform {SAMPLED} or fixed with "
        f"--redundancy {NUMERIC} serve"
    )


def why_redundancy_unserved(redundancy: str, model: CellModel) -> str | None:
    """Returns why a redundancy solver does not serve a robot, or None.

    Args:
        redundancy: its name.
        model: the job's cell.
    """
    if redundancy == CLOSED_FORMS and model.without_closed_form:
        return f"{_which(model)} without an arm angle: --redundancy {NUMERIC} serves"
    if redundancy == NUMERIC and not model.without_closed_form:
        return (
            f"every arm is spherical-revolute-spherical and has closed forms: --redundancy {CLOSED_FORMS} "
            "serves exactly"
        )
    return None


def _which(model: CellModel) -> str:
    names = model.without_closed_form
    verb = "is" if len(names) == 1 else "are"
    return f"{' and '.join(names)} {'arm' if len(names) == 1 else 'arms'} {verb}"
