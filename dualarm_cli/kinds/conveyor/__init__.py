"""Targets on conveyors: times and places of meeting, and tracking.

The cell file gives a conveyor's velocity (`cell_reading`), a task's pick or place names the conveyor (`reading`), and
the target has both (`model/part_flow.py`). `planning` and `meeting` choose times and places of meeting, `tracking`
computes the arm's motion.
"""
