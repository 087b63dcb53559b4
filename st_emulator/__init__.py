"""st-emulator: a hardware-in-the-loop star tracker firmware emulator."""

__version__ = "0.1.0"
