"""Schema of Denavit-Hartenberg tables in robot files."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from dualarm_cli.loading import quantities
from dualarm_cli.loading.fields import Angle, Length, Name, Pose, Quantity, Section, Size, refuse

JointSpeed = Annotated[float, Quantity(quantities.ANGULAR_VELOCITY, 1e-6)]
Torque = Annotated[float, Quantity(quantities.TORQUE, 0.0)]


class RowSection(Section):
    """One row of a table: a joint that turns, and the link that it moves."""

    joint: Name = Field(description="The joint's name; its link is called `<joint>_link`.")
    a: Length = Field(default=0.0, description="Length of the common normal [m].")
    alpha: Angle = Field(default=0.0, description="Twist about the common normal [rad].")
    d: Length = Field(default=0.0, description="Offset along the joint's axis [m].")
    theta: Angle = Field(default=0.0, description="What is added to the joint's position [rad].")
    lower: Angle = Field(description="Lowest position [rad].")
    upper: Angle = Field(description="Highest position [rad].")
    velocity: JointSpeed = Field(description="Largest speed [rad/s].")
    effort: Torque = Field(default=0.0, description="Largest torque [Nm]; 0: not known.")
    radius: Size | None = Field(
        default=None,
        description="Radius of a capsule from this joint's origin to the next one's; none: no shape [m].",
    )

    @model_validator(mode="after")
    def _range(self) -> RowSection:
        if self.lower > self.upper:
            raise refuse(
                f"lower limit {self.lower:g} rad is above upper limit {self.upper:g} rad", "lower"
            )
        return self


Rows = Annotated[list[RowSection], Field(min_length=1, max_length=12)]


class BasesSection(Section):
    """Where each arm's table begins."""

    left: Pose = Field(default=Pose(), description="Frame 0 of the left table in the root link.")
    right: Pose = Field(default=Pose(), description="Frame 0 of the right table in the root link.")


class DhSection(Section):
    """Arms as tables of Denavit and Hartenberg's parameters; every joint turns."""

    convention: Literal["standard", "modified"] = Field(
        default="standard",
        description="standard: Rz(theta + q) Tz(d) Tx(a) Rx(alpha); "
        "modified: Rx(alpha) Tx(a) Rz(theta + q) Tz(d), a and alpha those before the joint.",
    )
    left: Rows | None = Field(default=None, description="Rows of the left arm, base to flange.")
    right: Rows | None = Field(default=None, description="Rows of the right arm, base to flange.")
    bases: BasesSection = Field(
        default=BasesSection(), description="Where the tables begin; by default in the root link."
    )

    @model_validator(mode="after")
    def _some_arm(self) -> DhSection:
        if self.left is None and self.right is None:
            raise refuse("has no table; give left, right or both", code="E202")
        return self

    def tables(self) -> dict[str, list[RowSection]]:
        """Returns the tables that there are, left before right."""
        pairs = (("left", self.left), ("right", self.right))
        return {side: rows for side, rows in pairs if rows is not None}
