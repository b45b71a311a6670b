"""Layout studies: points over parameters, planned, ranked, and what matters of them."""
