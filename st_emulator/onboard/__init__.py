"""The unit round its firmware: telecommands, telemetry, modes, frames in time. Sans-IO; driven by the
virtual clock.
"""
