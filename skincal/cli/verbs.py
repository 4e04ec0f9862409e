"""The verbs of the command line, in the order of the work."""

from __future__ import annotations

import typer

from skincal.cli import (
    audit,
    collect,
    dataset,
    demo,
    deploy,
    diagnose,
    export_dr,
    fit,
    hand,
    imports,
    predict,
    rescale,
    train,
)
from skincal.cli import eval as evaluation
from skincal.cli import serve_hand as remote


def register(app: typer.Typer) -> None:
    """Add every verb to the application. A verb imports what it needs when it runs, so that help is fast."""
    app.add_typer(dataset.app, name="dataset")
    app.add_typer(imports.app, name="import")
    app.add_typer(hand.app, name="hand")
    # Typer would cut a line made of a docstring in the list of verbs.
    for verb, function, epilog, line in (
        ("collect", collect.collect, collect.EPILOG, "Press the skin with the hand's own indenter."),
        ("fit", fit.fit, fit.EPILOG, "Fit pose, elasticity and scale to the presses of a dataset."),
        ("predict", predict.predict, predict.EPILOG, "Write a dataset as a calibration predicts it."),
        ("audit", audit.audit, audit.EPILOG, "Show which effects presses can reveal, and how weak."),
        ("diagnose", diagnose.diagnose, diagnose.EPILOG, "Find what the model lacks, name it and add it."),
        ("export-dr", export_dr.export_dr, export_dr.EPILOG, "Write the ranges to train a policy over."),
        ("train", train.train, train.EPILOG, "Train a policy with soft actor-critic."),
        ("eval", evaluation.evaluate, evaluation.EPILOG, "Compare policies, evaluated as published."),
        ("deploy", deploy.deploy, deploy.EPILOG, "Run a policy on a hand, through its driver."),
        ("rescale", rescale.rescale, rescale.EPILOG, "Find how much sensitivity a skin has lost by wear."),
        ("serve-hand", remote.serve_hand, remote.EPILOG, "Serve a hand to another computer or program."),
        ("demo", demo.demo, demo.EPILOG, "Show the main job on a simulated hand."),
    ):
        app.command(verb, epilog=epilog, short_help=line)(function)
