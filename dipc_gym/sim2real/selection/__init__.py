"""Which effects a model lacks: hypotheses, screened, fitted and compared.

`search` says what is asked when; `rounds` what one round does: `hypotheses`, `screen`, `sketches`, `fitter`, `choice`.
Which windows serve for what stands in `partitioning` and `progress`, what counts as better in `score` and `scorer`.
"""
