"""Studies: methods over thousands of samples of a task."""

from .sample import Sample as Sample
from .sample import Start as Start
from .sample import draw_sample as draw_sample
from .study import Study as Study
from .study import study as study
