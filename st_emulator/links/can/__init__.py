"""Ends of a CAN bus: SocketCAN, slcan adapters, a bus in memory."""
