"""The verbs of the command line, in the order of the work."""

from __future__ import annotations

import typer

from skincal.cli import (
    audit,
    collect,
    dataset,
    diagnose,
    export_dr,
    fit,
    hand,
    imports,
    predict,
    serve_hand,
    train,
)
from skincal.cli import eval as evaluation


def register(app: typer.Typer) -> None:
    """Adds every verb to the application. A verb imports what it needs when it runs, so that help is fast."""
    app.add_typer(dataset.app, name="dataset")
    app.add_typer(imports.app, name="import")
    app.add_typer(hand.app, name="hand")
    app.command("serve-hand", epilog=serve_hand.EPILOG)(serve_hand.serve_hand)
    app.command("collect", epilog=collect.EPILOG)(collect.collect)
    app.command("fit", epilog=fit.EPILOG)(fit.fit)
    app.command("predict", epilog=predict.EPILOG)(predict.predict)
    app.command("audit", epilog=audit.EPILOG)(audit.audit)
    app.command("diagnose", epilog=diagnose.EPILOG)(diagnose.diagnose)
    app.command("export-dr", epilog=export_dr.EPILOG)(export_dr.export_dr)
    app.command("train", epilog=train.EPILOG)(train.train)
    app.command("eval", epilog=evaluation.EPILOG)(evaluation.evaluate)
