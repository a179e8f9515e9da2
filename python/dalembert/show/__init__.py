"""Plots, films, tables and pages of results."""
