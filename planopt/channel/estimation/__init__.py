"""Which channel the measurements come from: five methods, their likelihoods and their doubts."""
