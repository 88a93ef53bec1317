"""Scenes that other programs registered, read and written as scene folders of fsinfer; one module a format."""
