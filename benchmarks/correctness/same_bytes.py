"""Whether `dualarm plan` writes the same bytes on three classes of processors, which one machine plays.

python -m benchmarks.correctness.same_bytes [JOB ...] [--random 40] [--efforts quick normal]
    [--cores 1 2] [--timeout 600]

Without names all bundled jobs are planned. Library variants for older processors are chosen by environment variables;
that needs a processor with AVX-512 and FMA, and the command says so where the three do not differ.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parents[2]
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
ENVIRONMENTS: Mapping[str, Mapping[str, str]] = {
    "as it is": {},
    "no AVX-512": {
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    },
    "no FMA": {
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX512VL",
    },
}
"""Variables by processor: what AVX-512 ones take; Zen 2 and 3 and most laptops; those from before 2013."""
PROBE = """
import hashlib, math
import numpy as np
x = np.random.default_rng(0).uniform(-3.0, 3.0, 90_000)
A = x.reshape(300, 300)
for found in (A @ A, np.cbrt(x), [math.sin(v) for v in x.tolist()]):
    print(hashlib.sha256(np.asarray(found).tobytes()).hexdigest())
"""
"""Prints a line for BLAS, for numpy's own functions and for the C library."""


def blind() -> str:
    """Say why this machine cannot tell, or nothing."""
    blas, own, libm = (
        dict(zip(ENVIRONMENTS, lines, strict=True))
        for lines in zip(*map(_probed, ENVIRONMENTS), strict=True)
    )
    missing = [
        *(["OpenBLAS has one variant for all"] if len(set(blas.values())) < 3 else []),
        *(["numpy has no AVX-512 variants"] if own["as it is"] == own["no AVX-512"] else []),
        *(["the C library has no FMA variants"] if libm["as it is"] == libm["no FMA"] else []),
    ]
    if not missing:
        return ""
    return f"this processor cannot tell: here {' and '.join(missing)}; run on one with AVX-512"


def _probed(environment: str) -> list[str]:
    command = [sys.executable, "-c", PROBE]
    done = subprocess.run(command, env=_variables(environment), capture_output=True, check=True)
    return done.stdout.decode().split()


def _variables(environment: str) -> dict[str, str]:
    path = os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH")]))
    return {**os.environ, **ONE_THREAD, **ENVIRONMENTS[environment], "PYTHONPATH": path}


def plan_digest(
    tasks: Path, environment: str, options: Sequence[str] = (), timeout: float = 600.0
) -> tuple[str, int]:
    """Plan a job in an environment; the SHA-256 of what it prints, and its exit code."""
    command = [sys.executable, "-m", "dualarm_cli", "plan", str(tasks), "--out", "-", *options]
    done = subprocess.run(
        command, env=_variables(environment), cwd=HERE, capture_output=True, timeout=timeout
    )
    return hashlib.sha256(done.stdout).hexdigest()[:12], done.returncode


def same_everywhere(tasks: Path, options: Sequence[str] = (), timeout: float = 600.0) -> list[str]:
    """Plan a job in each environment; the environments in which it gives other bytes than in the first."""
    first, *others = (plan_digest(tasks, name, options, timeout) for name in ENVIRONMENTS)
    names = list(ENVIRONMENTS)[1:]
    return [name for name, found in zip(names, others, strict=True) if found != first]


def main() -> int:
    """Print a line for each job; 1 where bytes differ, 2 where the machine cannot tell."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("jobs", nargs="*", help="task files; all bundled jobs by default")
    parser.add_argument("--random", type=int, default=0, help="so many random valid jobs as well")
    parser.add_argument("--efforts", nargs="+", default=["quick"])
    parser.add_argument("--cores", nargs="+", type=int, default=[1])
    parser.add_argument("--timeout", type=float, default=600.0, help="of one plan [s]")
    given = parser.parse_args()
    if reason := blind():
        print(reason)
        return 2
    jobs = [Path(name).resolve() for name in given.jobs]
    jobs = jobs or sorted((HERE / "tasks").glob("[0-9]*/tasks.yaml"))
    differs = 0
    with tempfile.TemporaryDirectory() as folder:
        jobs += [_random_job(seed, Path(folder)) for seed in range(given.random)]
        for tasks in jobs:
            for effort in given.efforts:
                for cores in given.cores:
                    _use_cores(cores)
                    begun = time.process_time() + sum(os.times()[2:4])
                    try:
                        others = same_everywhere(tasks, ["--effort", effort], given.timeout)
                    except subprocess.TimeoutExpired:
                        others = [f"not planned within {given.timeout:g} s"]
                    used = time.process_time() + sum(os.times()[2:4]) - begun
                    differs += bool(others)
                    verdict = f"differs: {', '.join(others)}" if others else "same"
                    print(
                        f"{tasks.parent.name:20} {effort:8} {cores} {used:7.1f} s  {verdict}",
                        flush=True,
                    )
    return 1 if differs else 0


def _use_cores(count: int) -> None:
    """Restrict this process and its children to some of the cores."""
    usable = sorted(CORES)[:count]
    os.sched_setaffinity(0, usable)


CORES = os.sched_getaffinity(0)


def _random_job(seed: int, folder: Path) -> Path:
    spec = importlib.util.spec_from_file_location(
        "random_valid_jobs", HERE / "tests" / "random_valid_jobs.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    own = folder / f"random_{seed:02}"
    own.mkdir()
    module.write_random_job(seed, own)
    return own / "tasks.yaml"


if __name__ == "__main__":
    sys.exit(main())
