"""Terms of the weighted-sum objective: one module per group of terms, extensible."""
