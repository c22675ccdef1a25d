"""The commands of ``planopt``, one file each; heavy imports happen when a command runs."""
