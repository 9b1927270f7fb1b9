"""The film of a motion: cameras, floor and shadow, what stands around, views, and the files of pictures."""
