"""Readers of other layouts (ZJU-MoCap, DynaCap); `importing.import_capture` converts what they find into a
capture.
"""
