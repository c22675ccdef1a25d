"""Commands of ``planopt``, one file each; heavy imports are deferred until a command runs."""
