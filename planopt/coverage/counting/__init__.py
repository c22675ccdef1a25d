"""Counting: agents find over their links how many they are."""
