"""The command line: ``fgpose demo | calibrate | run | smooth | track | refine | info | evaluate | view``."""

from fgpose.cli.app import main as main
