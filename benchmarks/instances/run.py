"""The public instances, planned and verified: cycle time beside the reference, and planning time.

python -m benchmarks.instances.run [--only proseqqo airbus gp4] [--order given] [--arm split] [--mode paired]

References. ProSeqqo: the least cycle time of the order that is asked for, optimal, or given with the best
configurations. GP4: the steps' times from rest to rest, in pairs, or alone on the slower arm (a bound that no plan
reaches where arms must wait for each other). The Airbus pattern has none: its gap is to this tool's own lower bound.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.instances import airbus, gp4, proseqqo
from benchmarks.tables import print_head, print_row
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import DualArmError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify


@dataclass(frozen=True)
class Case:
    """One job and what it is measured against."""

    name: str
    """What it is called."""
    tasks: Path
    """Its task file."""
    timing: str
    """Timing solver that fits its limits."""
    reference: float | None
    """Cycle time to compare with [s]; None where only the lower bound stands."""


def cases(folder: Path, arguments: argparse.Namespace) -> Iterator[Case]:
    """Yields the jobs asked for after writing them."""
    if "proseqqo" in arguments.only:
        for name, optimum in proseqqo.OPTIMA.items():
            tasks = proseqqo.write_instance(name, folder / name, arguments.order)
            given = proseqqo.given_order_time(proseqqo.read_instance(name))
            reference = given if arguments.order == "given" else optimum
            yield Case(name, tasks, "trapezoid", reference)
    if "gp4" in arguments.only:
        for name in gp4.SPEED_SUMS:
            tasks = gp4.write_instance(name, folder / name, arguments.mode)
            limits = np.radians(gp4.ACCELERATION)
            left, right, together = gp4.step_sums(gp4.read_steps(name), limits)
            reference = together if arguments.mode == "paired" else max(left, right)
            yield Case(name, tasks, "trapezoid", reference)
    if "airbus" in arguments.only:
        tasks = airbus.write_instance(
            folder / "airbus", arguments.arm, arguments.order, arguments.mode
        )
        yield Case("airbus", tasks, "ruckig", None)


def measure(case: Case, effort: str) -> tuple[str, ...]:
    """Returns the row of one job; a plan that the verifier fails ends the benchmark."""
    begin = time.perf_counter()
    try:
        job = load_job(case.tasks)
        schedule = plan_without_bound(job, PlanSettings(timing=case.timing, effort=effort))
    except DualArmError as error:
        return case.name, f"no plan: {str(error).splitlines()[0]}", "", "", ""
    seconds = time.perf_counter() - begin
    failures = verify(schedule, job).failures
    if failures:
        raise SystemExit(f"{case.name}: {failures}")
    own = case.reference is None
    bound = job_bound(job, effort, "lines").value if own else case.reference
    row = case.name, f"{schedule.duration:.3f} s", f"{seconds:.1f} s"
    if bound is None:
        return *row, "", ""
    kind = "lower bound" if own else "reference"
    return *row, f"{kind} {bound:.3f} s", f"{schedule.duration / bound - 1.0:+.1%}"


def main() -> None:
    """Prints a row per job."""
    parser = argparse.ArgumentParser()
    families = ("proseqqo", "gp4", "airbus")
    parser.add_argument("--only", nargs="+", choices=families, default=families)
    parser.add_argument("--order", choices=("optimise", "given"), default="optimise")
    parser.add_argument("--arm", choices=("any", "split"), default="any")
    parser.add_argument("--mode", choices=("paired", "free"), default="paired")
    parser.add_argument("--effort", choices=("quick", "normal", "thorough"), default="normal")
    arguments = parser.parse_args()
    print_head("job", "cycle", "planned in", "compared with", "difference")
    with tempfile.TemporaryDirectory() as folder:
        for case in cases(Path(folder), arguments):
            print_row(*measure(case, arguments.effort))


if __name__ == "__main__":
    main()
