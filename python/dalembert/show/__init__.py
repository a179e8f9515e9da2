"""Pictures, tables and pages of what was computed."""
