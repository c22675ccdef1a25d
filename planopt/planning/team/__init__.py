"""Joint planning of one or several robots: goals of their own, or a sum of terms."""
