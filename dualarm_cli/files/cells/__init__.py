"""Cell files to cells."""
