"""Hands: the driver interface, and the guard that stands between a hand and whoever moves it."""
