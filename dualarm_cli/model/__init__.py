"""Data model: frozen values that flow from the files to the reports, and closed-form minimum times."""
