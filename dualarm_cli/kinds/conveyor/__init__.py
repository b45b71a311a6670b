"""Targets on conveyors: where parts are met, and how the tool stays with them.

The cell file has a conveyor's velocity (`cell_reading`), a task's pick or place names the conveyor (`reading`), and the
target carries both (`model/cell.py`). `planning` and `meeting` choose when and where parts are met, `tracking`
turns the velocity into the arm's motion.
"""
