"""The dialect ``sagitta``: binary frames with a hash on a serial line, as one flown driver speaks it."""
