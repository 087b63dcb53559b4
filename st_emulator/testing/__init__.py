"""What the pytest plugin is made of: units on a bench, time that runs until something holds, what a failed
test tells. Loaded when a test uses a fixture of :mod:`st_emulator.pytest_plugin`, never before.
"""
