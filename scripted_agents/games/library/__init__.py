"""Shipped small games."""

SHIPPED: dict[str, str] = {}
