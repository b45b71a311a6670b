"""The data model: frozen values that flow from the files to the reports; they neither read, write nor solve."""
