"""Localization for programs in any language: sessions, one a robot, and HTTP in front of them."""
