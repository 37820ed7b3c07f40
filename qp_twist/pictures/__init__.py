"""Pieces of pages and pictures: the scene in 3D, figures as SVG, colours, a server for viser."""
