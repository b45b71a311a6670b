"""Targets on conveyors: where parts are met, and how the tool stays with them."""
