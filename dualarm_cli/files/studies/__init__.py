"""Study files to studies."""
