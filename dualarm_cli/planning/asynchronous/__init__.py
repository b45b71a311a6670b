"""Plans of asynchronous arms: each arm's motion, and when it waits for the other one."""
