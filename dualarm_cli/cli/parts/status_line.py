"""One line on a terminal about what is being done, put into words whenever it is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dualarm_cli.orders.watch import Watch

if TYPE_CHECKING:
    from rich.text import Text


class StatusLine:
    """What is being done, as a thing that rich draws: the search is not kept by telling it anything more."""

    def __init__(self, watch: Watch, doing: str) -> None:
        """Begins with what is being done first; the watch tells what comes then."""
        self.watch, self.doing = watch, doing
        watch.tell = self.tell

    def tell(self, doing: str) -> None:
        """Something else is being done from now on."""
        self.doing = doing

    def words(self) -> str:
        """Returns the line as it is now: while a search goes on with its best, its bound and its time."""
        watch = self.watch
        if not watch.searching:
            return self.doing
        known = []
        if watch.best is not None:
            known.append(f"best {watch.best:.2f} s")
        if watch.bound is not None:
            known.append(f"bound {watch.bound:.2f} s")
        limit = "" if watch.limit is None else f" of {watch.limit:g} s"
        known.append(f"{watch.elapsed():.0f} s{limit}")
        return f"{self.doing}: {', '.join(known)}"

    def __rich__(self) -> Text:
        """Returns what is drawn."""
        from rich.text import Text

        return Text(self.words(), no_wrap=True, overflow="ellipsis")
