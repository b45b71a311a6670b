"""Random valid jobs of every kind of work on five robots: planned and verified, or refused with a reason."""

from __future__ import annotations

import pytest

from dualarm_cli.cli.run import run

SEEDS = range(300)
QUICK = (1, 26, 62, 94, 105, 133, 147)
"""One of most kinds, each planned within a few seconds; 26, 62 and 133 once failed."""

BLOCKED = (37, 177, 187)
"""Jobs of a YuMi that were refused though the other arm can do what one arm cannot."""


def judged(seed, folder, random_valid_jobs):
    """Plans a random job and returns what it is and the exit code; a plan is verified again from its files."""
    what = random_valid_jobs.write_random_job(seed, folder)
    tasks, out = str(folder / "tasks.yaml"), str(folder / "plan")
    code = run(["plan", tasks, "--out", out, "--effort", "quick", "--quiet"])
    if code == 0:
        assert run(["verify", out, "--tasks", tasks, "--quiet"]) == 0, what
    return what, code


@pytest.mark.parametrize("seed", QUICK)
def test_a_random_job_has_a_plan_that_is_verified_from_its_files(seed, tmp_path, random_valid_jobs):
    """Exit 0 for jobs that are known to have a plan."""
    what, code = judged(seed, tmp_path, random_valid_jobs)
    assert code == 0, what


@pytest.mark.slow
@pytest.mark.parametrize("seed", BLOCKED)
def test_a_task_that_an_idle_arm_blocks_is_done_by_the_other_arm(seed, tmp_path, random_valid_jobs):
    """Exit 0: either arm may do it, and there is an order in which nothing is in the way."""
    what, code = judged(seed, tmp_path, random_valid_jobs)
    assert code == 0, what


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_no_random_job_crashes_or_fails_verification(seed, tmp_path, capsys, random_valid_jobs):
    """Exit 0, or 3 with a sentence on stderr: a valid file is never refused as input, and no plan is unsound."""
    what, code = judged(seed, tmp_path, random_valid_jobs)
    assert code in (0, 3), what
    if code == 3:
        assert capsys.readouterr().err.startswith("error: "), what
