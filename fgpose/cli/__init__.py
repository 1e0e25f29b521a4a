"""The command line: ``fgpose demo | smooth | track | refine | info | evaluate | view``."""

from fgpose.cli.app import main as main
