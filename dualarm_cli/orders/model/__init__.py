"""Jobs as numbers for the order searches: postures of tasks, collisions of pairs, buffers, tool changes."""
