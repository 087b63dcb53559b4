"""Errors that a person can act on: one line, what is wrong and what is allowed. The command line exits
with status 2.
"""

from __future__ import annotations


class ConfigurationError(Exception):
    """A unit file, scenario file, option or input file is not usable; the message names file, key and
    what is allowed.
    """
