"""Beyond the paper: the preset (test 5b) and the identified sample (test 6)."""


rule accuracy:
    input:
        "results/table1.csv",
        expand(
            "results/figures/{name}.{kind}",
            name=["test5b", "test6", "stiffness"],
            kind=["png", "pdf"],
        ),


rule preset:
    input:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        bubbles="results/bubbles.csv",
        background="results/phantom/background.tif",
        code=code("estimate"),
    output:
        displacement="results/tests/5b/displacement.tif",
        deviation="results/tests/5b/deviation.tif",
    log:
        "logs/preset.log",
    benchmark:
        "benchmarks/preset.tsv"
    resources:
        mem_mb=1000,
    params:
        options=options(settings.preset),
    shell:
        "eofm estimate {input.reference} {input.deformed} --bubbles {input.bubbles}"
        " --background {input.background} --output {output.displacement}"
        " --deviation {output.deviation} {params.options} > {log} 2>&1"


rule stiffness:
    input:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        bubbles="results/bubbles.csv",
        code=code("stiffness", "uncertainty"),
    output:
        stiffness="results/tests/6/stiffness.tif",
        displacement="results/tests/6/displacement.tif",
        deviation="results/tests/6/deviation.tif",
        stiffness_deviation="results/tests/6/stiffness_deviation.tif",
    log:
        "logs/stiffness.log",
    benchmark:
        "benchmarks/stiffness.tsv"
    resources:
        mem_mb=2000,
    params:
        # The inclusions are what is sought.
        options=options(
            settings.sample.changed(inclusions=()),
            settings.identification,
            settings.preset,
        ),
    shell:
        "eofm stiffness {input.reference} {input.deformed} --bubbles {input.bubbles}"
        " --output {output.stiffness} --displacement {output.displacement}"
        " --deviation {output.deviation} --stiffness-deviation {output.stiffness_deviation}"
        " {params.options} > {log} 2>&1"


rule figure_stiffness:
    input:
        stiffness="results/tests/6/stiffness.tif",
        deviation="results/tests/6/stiffness_deviation.tif",
        code=code("figures", "forward"),
    output:
        png=report(
            "results/figures/stiffness.png",
            caption="../report/stiffness.rst",
            category="Beyond the paper",
            labels={"figure": "stiffness"},
        ),
        pdf="results/figures/stiffness.pdf",
    log:
        "logs/figures/stiffness.log",
    benchmark:
        "benchmarks/figures/stiffness.tsv"
    resources:
        mem_mb=500,
    params:
        figures=settings.figures.model_dump(),
        sample=settings.sample.model_dump(),
    script:
        "../scripts/figure_stiffness.py"
