"""Figures 3 to 7 of the paper, and tests 2 and 4 drawn in the same way."""

SHOWN = {
    "figure5": "1",
    "figure6": "3",
    "figure7": "5",
    "test2": "2",
    "test4": "4",
    "test5b": "5b",
    "test6": "6",
}


rule figure_sample:
    input:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        code=code("figures"),
    output:
        png=report(
            "results/figures/figure3.png",
            caption="../report/figure3.rst",
            category="Phantom",
            labels={"figure": "3: before and after"},
        ),
        pdf="results/figures/figure3.pdf",
    log:
        "logs/figures/figure3.log",
    benchmark:
        "benchmarks/figures/figure3.tsv"
    resources:
        mem_mb=500,
    params:
        figures=settings.figures.model_dump(),
    script:
        "../scripts/figure_sample.py"


rule figure_truth:
    input:
        truth="results/phantom/true.tif",
        code=code("figures"),
    output:
        png=report(
            "results/figures/figure4.png",
            caption="../report/figure4.rst",
            category="Phantom",
            labels={"figure": "4: true displacement"},
        ),
        pdf="results/figures/figure4.pdf",
    log:
        "logs/figures/figure4.log",
    benchmark:
        "benchmarks/figures/figure4.tsv"
    resources:
        mem_mb=500,
    params:
        figures=settings.figures.model_dump(),
    script:
        "../scripts/figure_truth.py"


rule figure_test:
    input:
        estimate=lambda wildcards: f"results/tests/{SHOWN[wildcards.figure]}/displacement.tif",
        truth="results/phantom/true.tif",
        table="results/table1.csv",
        deviation=lambda wildcards: (
            f"results/tests/{SHOWN[wildcards.figure]}/deviation.tif"
            if SHOWN[wildcards.figure] in OURS
            else []
        ),
        code=code("figures"),
    output:
        png=report(
            "results/figures/{figure}.png",
            caption="../report/figure_test.rst",
            category="Tests",
            labels={"figure": "{figure}"},
        ),
        pdf="results/figures/{figure}.pdf",
    log:
        "logs/figures/{figure}.log",
    benchmark:
        "benchmarks/figures/{figure}.tsv"
    wildcard_constraints:
        figure="|".join(SHOWN),
    resources:
        mem_mb=500,
    params:
        figures=settings.figures.model_dump(),
        test=lambda wildcards: SHOWN[wildcards.figure],
    script:
        "../scripts/figure_test.py"
