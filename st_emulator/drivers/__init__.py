"""Who moves the virtual clock: real time, or as fast as the computer can."""
