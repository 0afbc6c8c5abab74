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
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("estimate", settings.sample.shape),
    params:
        options=options(settings.preset),
    shell:
        "eofm estimate --threads {threads} {input.reference} {input.deformed} --bubbles {input.bubbles}"
        " --background {input.background} --output {output.displacement}"
        " --deviation {output.deviation} {params.options} > {log} 2>&1 || [ $? -eq 3 ]"


rule stiffness:
    input:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        bubbles="results/bubbles.csv",
        code=code("stiffness"),
    output:
        stiffness="results/tests/6/stiffness.tif",
        displacement="results/tests/6/displacement.tif",
        deviation="results/tests/6/deviation.tif",
        stiffness_deviation="results/tests/6/stiffness_deviation.tif",
    log:
        "logs/stiffness.log",
    benchmark:
        "benchmarks/stiffness.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("stiffness", settings.sample.shape),
    params:
        # The inclusions are what is sought.
        options=options(
            settings.sample.changed(inclusions=()),
            settings.identification,
            settings.preset,
        ),
    shell:
        "eofm stiffness --threads {threads} {input.reference} {input.deformed} --bubbles {input.bubbles}"
        " --output {output.stiffness} --displacement {output.displacement}"
        " --deviation {output.deviation} --stiffness-deviation {output.stiffness_deviation}"
        " {params.options} > {log} 2>&1"


rule figures_ours:
    input:
        test5b="results/tests/5b/displacement.tif",
        test5b_deviation="results/tests/5b/deviation.tif",
        test6="results/tests/6/displacement.tif",
        test6_deviation="results/tests/6/deviation.tif",
        truth="results/phantom/true.tif",
        tests=expand("results/tests/{test}/displacement.tif", test=TESTS),
        code=code("figures.py"),
    output:
        test5b=test_figure("test5b", "5b"),
        test6=test_figure("test6", "6"),
        pdf=["results/figures/test5b.pdf", "results/figures/test6.pdf"],
    log:
        "logs/figures_ours.log",
    benchmark:
        "benchmarks/figures_ours.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("figures", settings.sample.shape),
    params:
        figures=settings.figures.model_dump(),
    script:
        "../scripts/figures.py"


rule figure_stiffness:
    input:
        stiffness="results/tests/6/stiffness.tif",
        deviation="results/tests/6/stiffness_deviation.tif",
        code=code("figure_stiffness.py"),
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
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("figures", settings.sample.shape),
    params:
        figures=settings.figures.model_dump(),
        sample=settings.sample.model_dump(),
    script:
        "../scripts/figure_stiffness.py"
