"""The CI workflow of a first project: `docs/score-workflow.yaml` with the project's own task files."""

from __future__ import annotations

WORKFLOW = """\
# Cycle times that must not get worse. Before the first run, complete requirements.txt, write scores.json and commit it:
#   dualarm score tasks.yaml --baseline scores.json --update-baseline
name: score
on:
  pull_request:
  push:
    branches: [main]
permissions:
  contents: read
concurrency:
  group: score-${{ github.ref }}
  cancel-in-progress: true
jobs:
  score:
    runs-on: ubuntu-latest
    timeout-minutes: 60
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "3.12"
          cache: pip
      - run: python -m pip install -r requirements.txt
      - uses: actions/cache/restore@v4
        with:
          path: ~/.cache/dualarm
          key: dualarm-${{ github.run_id }}
          restore-keys: dualarm-
      - run: >-
          dualarm score tasks.yaml --baseline scores.json --max-regression 2%
          --timeout '10 min' --cache ~/.cache/dualarm --junit score.xml --github
      - uses: actions/cache/save@v4
        if: always()  # what was planned is not planned again, also where the gate is closed
        with:
          path: ~/.cache/dualarm
          key: dualarm-${{ github.run_id }}
      - uses: actions/upload-artifact@v4
        if: always()
        with:
          name: score
          path: score.xml
          if-no-files-found: ignore
"""
"""Text of the workflow."""
REQUIREMENTS = """\
# Installs dualarm in CI, in the version that scores.json was made with. No package index has it: name its repository.
# dualarm @ git+https://<address of the repository>@<a tag>
"""
"""Text of the file that the workflow installs from."""
