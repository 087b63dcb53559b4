"""Lost in space: which catalogue star is each spot. All algorithms share ``interface.py``."""
