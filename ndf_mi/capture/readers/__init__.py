"""Readers of other layouts; `importing.import_capture` converts what they find into a capture."""
