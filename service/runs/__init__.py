"""A test: asked for, driven, recorded, analysed."""
