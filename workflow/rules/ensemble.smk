"""Random phantoms: the errors of all methods and other tools, and how honest error bars are."""

ENSEMBLE = "results/ensemble"
NUMBERS = range(1, settings.ensemble.count + 1)
ENSEMBLE_TOOLS = ["elastix", "dis", "demons"]


rule ensemble:
    input:
        f"{ENSEMBLE}/test6.csv",
        expand("{folder}/ensemble.{kind}", folder=ENSEMBLE, kind=["png", "pdf"]),


rule ensemble_phantom:
    input:
        code=code("ensemble_phantom.py"),
    output:
        **{
            name: f"{ENSEMBLE}/{{number}}/{name}.tif"
            for name in [
                "reference",
                "deformed",
                "true",
                "background",
                "test5",
                "preset_free",
                "preset",
                "test6",
                "stiffness",
                "deviation",
            ]
        },
        bubbles=f"{ENSEMBLE}/{{number}}/bubbles.csv",
        errors=f"{ENSEMBLE}/{{number}}/errors.csv",
    log:
        "logs/ensemble/{number}.log",
    benchmark:
        "benchmarks/ensemble/{number}.tsv"
    wildcard_constraints:
        number=r"\d+",
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=2000,
    params:
        **{
            name: getattr(settings, name).model_dump()
            for name in [
                "ensemble",
                "sample",
                "forward",
                "phantom",
                "virtual_oct",
                "tracking",
                "estimation",
                "preset",
                "identification",
            ]
        },
    script:
        "../scripts/ensemble_phantom.py"


rule ensemble_peers:
    input:
        reference=f"{ENSEMBLE}/{{number}}/reference.tif",
        deformed=f"{ENSEMBLE}/{{number}}/deformed.tif",
        truth=f"{ENSEMBLE}/{{number}}/true.tif",
        code=code("ensemble_peers.py"),
    output:
        f"{ENSEMBLE}/{{number}}/peers.csv",
    log:
        "logs/ensemble/{number}-peers.log",
    benchmark:
        "benchmarks/ensemble/{number}-peers.tsv"
    wildcard_constraints:
        number=r"\d+",
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        tools=ENSEMBLE_TOOLS,
    script:
        "../scripts/ensemble_peers.py"


rule ensemble_figure:
    input:
        ours=expand("{folder}/{n}/errors.csv", folder=ENSEMBLE, n=NUMBERS),
        others=expand("{folder}/{n}/peers.csv", folder=ENSEMBLE, n=NUMBERS),
        code=code("ensemble.py"),
    output:
        table=report(
            f"{ENSEMBLE}/test6.csv",
            caption="../report/ensemble.rst",
            category="Ensemble",
        ),
        png=report(
            f"{ENSEMBLE}/ensemble.png",
            caption="../report/ensemble.rst",
            category="Ensemble",
        ),
        pdf=f"{ENSEMBLE}/ensemble.pdf",
    log:
        "logs/ensemble/table.log",
    benchmark:
        "benchmarks/ensemble/table.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=500,
    params:
        tools=ENSEMBLE_TOOLS,
        figures=settings.figures.model_dump(),
    script:
        "../scripts/ensemble.py"
