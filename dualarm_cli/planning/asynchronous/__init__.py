"""Plans of asynchronous arms: each arm's motion and its waits for the other."""
