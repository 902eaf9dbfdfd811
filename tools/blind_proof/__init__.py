"""The blind proof: data in which an effect is concealed, sealed truth, verdicts, scores, rivals."""
