"""The CAN bus in virtual time, the controller on it, and the ports through which it is used."""
