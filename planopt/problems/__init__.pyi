"""Public names that some problems need; each is imported from its module when it is first used."""

from planopt.coverage.simulation import NetworkController as NetworkController
from planopt.problems.channel_setup import ArrayTruth as ArrayTruth
from planopt.problems.channel_setup import FittedTruth as FittedTruth
from planopt.problems.channel_setup import FunctionTruth as FunctionTruth
from planopt.problems.channel_setup import GivenParameters as GivenParameters
from planopt.problems.channel_setup import LoggedMeasurements as LoggedMeasurements
from planopt.problems.channel_setup import MeasuredTruth as MeasuredTruth
from planopt.problems.channel_setup import ModelTruth as ModelTruth
from planopt.problems.channel_setup import RasterTruth as RasterTruth
from planopt.problems.channel_setup import SampledMeasurements as SampledMeasurements
from planopt.problems.draft import Draft as Draft
from planopt.problems.draft import DraftSettings as DraftSettings
from planopt.problems.draft import DraftStation as DraftStation
from planopt.problems.draft import draft_problem as draft_problem
from planopt.problems.library import list_problems as list_problems
from planopt.problems.load import problem_from_dict as problem_from_dict
from planopt.problems.load import problem_to_dict as problem_to_dict
from planopt.problems.settings import ReportSettings as ReportSettings
from planopt.problems.tasks import TaskProblem as TaskProblem
from planopt.pursuit.service import Record as Record
from planopt.pursuit.simulation import PursuitController as PursuitController
from planopt.robots.models import DoubleIntegrator as DoubleIntegrator
from planopt.robots.models import SingleIntegrator as SingleIntegrator
from planopt.robots.models import Unicycle as Unicycle
from planopt.world.occupancy import OccupancyGrid as OccupancyGrid
from planopt.world.occupancy import read_grid as read_grid
