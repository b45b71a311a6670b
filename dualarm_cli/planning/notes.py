"""Sentences on orders that plans carry as notes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from dualarm_cli.notes import Note

ESTIMATE = "the estimate of the search, which has few postures and platform angles per stop: a plan may be much faster"
"""Meaning of the time of an order on the search's grid."""
_ON_GRID = "on the grid of the search (its postures, the platform standing at one of its angles)"
_NOT_PLANS = "this proves nothing about plans, which leave the grid"
SENTENCES: Mapping[str, Mapping[str, str]] = {
    "order": {
        "of_file": "that of the file, whose plan is faster than those of the orders found",
        "fixed": "--time-limit has no effect, as the task file fixes the order",
        "ended_early": "the search ended early, as {why}; a longer search may find a faster plan",
        "after_part": "{later} comes after {first}, as its part would be in the way",
        "after_link": "{later} comes after {first}, as a part would be in the way",
        "sections": "of {tried} planned orders, {whose} is the fastest: {rows}",
        "found": f"{{how}}; {{total:.2f}} s by {ESTIMATE}",
        "best": f"{_ON_GRID} this order is proven to be the best; {_NOT_PLANS}",
    },
    "order bound": {
        "stages": "on the grid of the search (its platform angles and postures), where this order takes {total:.2f} s, "
        f"no order takes less than {{bound:.2f}} s; {_NOT_PLANS}: another order may be faster",
        "clocks": f"{_ON_GRID}, where this order takes {{total:.2f}} s, no order takes less than {{bound:.2f}} s; "
        f"{_NOT_PLANS}",
    },
}
"""Sentences by topic and key."""
planning_note = partial(Note.of, SENTENCES)
"""Make a note of planning, from its topic, key and data."""
