"""What no order can mend is refused after few tries, not after all."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from dualarm_cli.errors import BlockedError
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning import clearing, ordered_plan
from dualarm_cli.planning.clearing import Clearing
from dualarm_cli.planning.method import PathBudget
from dualarm_cli.planning.ordered_plan import HOPELESS, SEARCHES, TAKEN_APART
from dualarm_cli.planning.orders import DecidedOrder, Orders
from dualarm_cli.planning.watch import Watch


class Blocked:
    """A search whose orders never keep clear: each time in another stage of both arms."""

    def __init__(self, alone):
        """Says whether one arm alone is to blame."""
        self.alone, self.tries = alone, 0

    def without(self, _pairs, _first):
        """The search goes on."""
        return self

    def orders(self, _watch=None):
        """One order of ten stages."""
        tasks = [
            {
                arm: (
                    SimpleNamespace(id=f"{arm}-{k}", is_change=False),
                    SimpleNamespace(action="move"),
                )
                for arm in ("left", "right")
            }
            for k in range(10)
        ]
        return Orders((DecidedOrder(SimpleNamespace(stages=lambda: tasks), 1.0),), None, "")

    as_it_is = orders

    def planned(self, _one, of, patient):
        """No plan."""
        self.tries += 1
        raise BlockedError("it touches", (self.tries - 1,), alone=self.alone)


@pytest.mark.parametrize("effort", HOPELESS)
@pytest.mark.parametrize("alone", [True, False])
def test_where_an_arm_touches_by_itself_other_orders_are_soon_given_up(alone, effort, monkeypatch):
    """Where it is both arms that touch, they are taken apart as often as ever."""
    monkeypatch.setattr(ordered_plan, "_promising", lambda _s, found, *_: list(found))
    monkeypatch.setattr(ordered_plan, "stop_name", lambda task: task.id)
    search = Blocked(alone)
    settings = PlanSettings(effort=effort)
    with pytest.raises(BlockedError, match="it touches"):
        ordered_plan._searched(search, search.orders(), settings, Watch(), search.planned)
    most = SEARCHES + TAKEN_APART + 1
    assert search.tries == (min(most, HOPELESS[effort]) if alone else most)


def test_only_so_many_searches_for_paths_may_fail(monkeypatch):
    """Two fail; then none is made, but as many as serve are."""
    made = []

    def transfer_path(*_):
        made.append(1)
        return None if len(made) != 2 else "path"

    monkeypatch.setattr(clearing, "transfer_path", transfer_path)
    monkeypatch.setattr(clearing, "replace", lambda plan, **changes: changes["path"])
    holding = SimpleNamespace(before=[None, None], after=[None, None], cell=None)
    tools = Clearing(None, None, holding, None, 0, None, PathBudget(2))
    found = [tools._path(None, 0) for _ in range(5)]
    assert found == [None, "path", None, None, None]
    assert len(made) == 3
