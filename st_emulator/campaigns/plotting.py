"""Plots of campaigns: one figure in the style of the other pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib import pyplot as plt

from ..commands.pictures import STYLE, require_picture_path
from ..errors import ConfigurationError

COLOURS = ("#40c4ff", "#ffb000", "#69d58c", "#ff7ab6")
SOURCE_COLOUR = "#e8eaed"  # of what a paper printed


def require_plot_path(path: Path) -> None:
    """See before the work that the plot can be written. ConfigurationError: it cannot."""
    try:
        require_picture_path(path)
    except ConfigurationError as error:
        raise ConfigurationError(f"--plot {error}") from error


def write_plot(path: Path, draw: Callable[[Any], None]) -> None:
    """Draw a campaign's plot. ConfigurationError: the file cannot be written."""
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(11, 5.5), layout="constrained")
        try:
            draw(figure)
            figure.savefig(path, dpi=110)
        except OSError as error:
            raise ConfigurationError(f"--plot {path}: cannot be written: {error.strerror}") from error
        finally:
            plt.close(figure)
