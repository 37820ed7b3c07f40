"""The controller: one verified step."""

from .controller import Controller as Controller
from .step import Status as Status
from .step import Step as Step
