"""From a study to an output folder: the stages, resumed and skipped by what they depend on."""
