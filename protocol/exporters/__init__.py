"""Documents and files generated from the registry."""

from .icd import interface_control_document

__all__ = ["interface_control_document"]
