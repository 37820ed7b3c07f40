"""Studies: methods over thousands of samples of a task."""

from .part_tolerance import PartTolerance as PartTolerance
from .part_tolerance import part_tolerance as part_tolerance
from .placement_search import BestPlacement as BestPlacement
from .placement_search import best_placement as best_placement
from .sample import Sample as Sample
from .sample import Start as Start
from .sample import draw_sample as draw_sample
from .study import Study as Study
from .study import study as study
