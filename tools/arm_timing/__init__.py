"""ARM926EJ-S programs run in an instruction-set simulator, each instruction costed by the manual's table."""

import st_emulator  # noqa: F401  first of all: it says where numba keeps compiled callbacks
