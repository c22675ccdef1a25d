"""Connectivity along whole paths: jointly, until connected, outages, data, several stations."""
