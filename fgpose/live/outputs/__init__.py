"""What a live system sends out."""

from fgpose.live.outputs.lsl_output import open_lsl_output as open_lsl_output
from fgpose.live.outputs.mcap_output import open_mcap_output as open_mcap_output
from fgpose.live.outputs.mcap_output import recover_mcap as recover_mcap
from fgpose.live.outputs.output import BackgroundOutput as BackgroundOutput
from fgpose.live.outputs.output import Output as Output
from fgpose.live.outputs.output import OutputState as OutputState
from fgpose.live.outputs.viewer_output import ViewerOutput as ViewerOutput
from fgpose.live.outputs.zmq_output import open_zmq_output as open_zmq_output
