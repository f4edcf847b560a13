"""Everything that is compared, one module each, behind one protocol and one registry."""
