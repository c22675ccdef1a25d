"""Problems whose objective is a sum of terms, for one robot or several."""
