"""Sweeps and ablations: who does the runs, tables, statistics, reports."""
