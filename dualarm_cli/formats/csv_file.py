"""Samples as text, the same columns as `schedule.csv` at any rate, and events as a second table."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping

import pinocchio as pin

from dualarm_cli.exporting.files import FORMULA, TABLE, to_csv
from dualarm_cli.formats.request import ExportRequest
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.verification.as_done import events_by_stage

EVENTS = "events.csv"
HEADER = ("time", "dwell", "arm", "task", "action", "stage", "signal", "frame", "x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Returns `schedule.csv` at the request's rate, and `events.csv`: [s], [rad], [m]."""
    schedule = request.schedule
    return {TABLE: to_csv(schedule, request.rate), EVENTS: [_events(schedule)]}


def _events(schedule: Schedule) -> bytes:
    """Returns a row for each event; stages count from 0, empty where an event is in none."""
    stages = {
        id(event): number
        for number, events in enumerate(events_by_stage(schedule))
        for event in events
    }
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow((*HEADER, *QUATERNION))
    for event in schedule.events:
        words = (event.arm, event.task, event.action, stages.get(id(event), ""), event.signal)
        place = event.pose.translation.tolist()
        turn = pin.Quaternion(event.pose.rotation).coeffs().tolist()
        cells = map(_safe, (*words, event.frame))
        rows.writerow((event.time, event.dwell, *cells, *place, *turn))
    return text.getvalue().encode("utf-8", "backslashreplace")


def _safe(value: object) -> object:
    """Returns a text that no spreadsheet takes for a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value
