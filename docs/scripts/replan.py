"""What if a part lies elsewhere? Replans in a loop, as a camera would ask for it, and compares each plan."""

import random

from dualarm_cli import InfeasibleError, compare, load, plan

JOB = "01_first_pick"  # a task file, or the name of a bundled job
WHERE = "tasks:/tasks/left part/pick/xyz"  # the file, then the task by its id

camera = random.Random(7)
last = plan(load(JOB), effort="quick")
for cycle in range(1, 4):
    seen = [0.45 + camera.uniform(-0.05, 0.05), 0.20 + camera.uniform(-0.05, 0.05), 0.80]
    try:
        result = plan(load(JOB, {WHERE: seen}), effort="quick")
    except InfeasibleError as error:
        print(f"cycle {cycle}: no plan: {error}")
        continue
    if result.verified:
        sentence = compare(last, result)["sentence"]
        print(f"cycle {cycle}: part at {seen[0]:.3f}, {seen[1]:.3f} m: {sentence}")
        last = result
last.write("last-plan", force=True)
