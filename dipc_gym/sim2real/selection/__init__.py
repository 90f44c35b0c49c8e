"""Which effects a model lacks: hypotheses, screened, fitted and compared."""
