"""Captures of rigged characters: reads glTF, plays its animations, and fits Anny to what moves."""
