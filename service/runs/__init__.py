"""The life of a test: asked for, driven, recorded, analysed."""
