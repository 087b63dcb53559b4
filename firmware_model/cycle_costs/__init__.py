"""Cycle coefficients of processors, one JSON file each (read by ``processor.py``)."""
