"""ARM926EJ-S programs run in an instruction-set simulator, each instruction costed by the manual's table."""
