"""The star tracker: commands in, reports out, in virtual time. It knows no wire."""
