"""The command line of fgpose."""

from fgpose.cli.app import main as main
