"""Captures of others' layouts (ZJU-MoCap, DynaCap), read into what `importing.import_capture` makes a capture of ours from."""
