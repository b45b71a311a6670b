"""The pipeline from a job to a schedule: the only place where the families of solvers meet."""
