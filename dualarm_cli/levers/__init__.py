"""Levers of a plan: changes of its job's files, with their gains.

Start at `changes` (the list of levers), `estimates` (gains from the plan itself) and `replanning` (verified gains).
"""
