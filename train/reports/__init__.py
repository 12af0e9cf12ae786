"""All tables, figures and pages, made from plain data."""
