"""Scenes as other programs leave them: files of Gaussians, folders of trained scenes, pictures with cameras."""
