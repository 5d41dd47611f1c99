"""The operations of models as functions of the model: methods of `ShapeModel` by other names."""

from ostiform.model.types import ShapeModel

project = ShapeModel.project
reconstruct = ShapeModel.reconstruct
sample_scores = ShapeModel.sample_scores
truncated = ShapeModel.truncated
marginal = ShapeModel.marginal
part_marginal = ShapeModel.part
posterior = ShapeModel.posterior
resampled = ShapeModel.resampled
resampled_onto = ShapeModel.resampled_onto
point_deviations = ShapeModel.point_deviations
model_plotter = ShapeModel.plot
