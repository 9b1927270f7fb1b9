"""What this machine can run, and what would have to be fetched for the rest: ``python -m diffuphy.doctor``."""
