"""Figures 3 to 7 of the paper, and tests 2 and 4 drawn in the same way: one job for all."""

SHOWN = {"figure5": "1", "figure6": "3", "figure7": "5", "test2": "2", "test4": "4"}


rule figures:
    input:
        **{
            name: f"results/tests/{test}/displacement.tif"
            for name, test in SHOWN.items()
        },
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        truth="results/phantom/true.tif",
        tests=expand("results/tests/{test}/displacement.tif", test=TESTS),
        code=code("figures.py"),
    output:
        **{name: test_figure(name, test) for name, test in SHOWN.items()},
        figure3=report(
            "results/figures/figure3.png",
            caption="../report/figure3.rst",
            category="Phantom",
            labels={"figure": "3: before and after"},
        ),
        figure4=report(
            "results/figures/figure4.png",
            caption="../report/figure4.rst",
            category="Phantom",
            labels={"figure": "4: true displacement"},
        ),
        pdf=expand("results/figures/{name}.pdf", name=["figure3", "figure4", *SHOWN]),
    log:
        "logs/figures.log",
    benchmark:
        "benchmarks/figures.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("figures", settings.sample.shape),
    params:
        figures=settings.figures.model_dump(),
    script:
        "../scripts/figures.py"
