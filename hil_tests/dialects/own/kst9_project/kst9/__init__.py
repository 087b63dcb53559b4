"""The language of the KST-9 (see ../../icd.md)."""
