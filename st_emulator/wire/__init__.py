"""The unit's wire in virtual time, a serial line or a CAN bus, and the port through which it is used."""
