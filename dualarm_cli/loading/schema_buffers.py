"""Schema of buffers in task files."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from dualarm_cli.loading.fields import Section, refuse

MOST_PARTS = 1_000_000
"""Most parts of a buffer."""


class BufferSection(Section):
    """Room for parts that are all alike, on the way from one task to another."""

    capacity: Annotated[int, Field(ge=1, le=MOST_PARTS)] = Field(
        description="How many parts it has room for."
    )
    initial: Annotated[int, Field(ge=0, le=MOST_PARTS)] = Field(
        default=0, description="How many parts are in it at the start."
    )

    @model_validator(mode="after")
    def _room_for_all(self) -> BufferSection:
        if self.initial > self.capacity:
            text = (
                f"{self.initial} parts at the start; there is room for {self.capacity} (capacity)"
            )
            raise refuse(text, "initial")
        return self
