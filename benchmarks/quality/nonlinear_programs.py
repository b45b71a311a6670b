"""The search over whole sequences against nonlinear programs by IPOPT, with stops and nothing in the way.

python -m benchmarks.quality.nonlinear_programs [TASKS ...] [--effort normal]

Printed per task file: the cycle time [s] by `sequence`, that of its plan refined over angles
(`nonlinear/continuous.py`), that by `fixed`, and that of a program over all joints which starts from it
(`nonlinear/ipopt.py`). Arms need closed forms.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.nonlinear.continuous import refine
from benchmarks.nonlinear.ipopt import nonlinear_program
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.orders.order_trials import repaired
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.stages.sequence import decisions_of
from dualarm_cli.stages.sequence_problem import sequence_problem

PACKING = Path(__file__).parents[2] / "tasks" / "04_packing" / "tasks.yaml"


def compare(file: Path, effort: str) -> list[float]:
    """Returns the cycle times of `sequence`, its refinement, `fixed` and the program over joints [s]."""
    job = load_job(file)
    model = CellModel.from_cell(job.cell)
    problem = sequence_problem(model, job)
    totals = []
    for name, improve in (("sequence", refine), ("fixed", nonlinear_program)):
        decided = METHODS[name].solve(MethodProblem(model, job, "arm_angle", effort))
        plan = repaired(problem, decisions_of(problem, model, decided.stages))
        if plan is None:
            raise SystemExit(f"{file}: the plan of {name} is too close to a joint limit")
        totals += [plan.total, improve(problem, plan).total]
    return totals


def main() -> None:
    """Prints a table, a row per file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="*", type=Path, default=[PACKING])
    parser.add_argument("--effort", default="normal")
    asked = parser.parse_args()
    print("| tasks | sequence | refined | fixed | program over joints |")
    for file in asked.tasks:
        numbers = " | ".join(f"{total:.3f}" for total in compare(file, asked.effort))
        print(f"| {file.parent.name} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
