"""The virtual OCT experiment: tomograms, tracking, both methods, errors, Figures 1, 2 and 8."""

VIRTUAL = "results/virtual_oct"

# Test 5's parameters, without conditions at edges that lie inside of the sample. Standard
# optical flow differs in what it lacks: bubbles and a background.
METHODS = {
    "standard": IMAGES_ONLY,
    "eofm": WARPED,
}


rule virtual_oct:
    input:
        f"{VIRTUAL}/errors.csv",
        expand(
            "{folder}/figures/figure{number}.{kind}",
            folder=VIRTUAL,
            number=[1, 2, 8],
            kind=["png", "pdf"],
        ),


rule virtual_oct_tomograms:
    input:
        truth="results/phantom/true.tif",
        background="results/phantom/background.tif",
        code=code("virtual-oct"),
    output:
        reference=f"{VIRTUAL}/reference.tif",
        deformed=f"{VIRTUAL}/deformed.tif",
        truth=f"{VIRTUAL}/true.tif",
        background=f"{VIRTUAL}/background.tif",
    log:
        "logs/virtual_oct/tomograms.log",
    benchmark:
        "benchmarks/virtual_oct/tomograms.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        options=options(settings.virtual_oct),
    shell:
        "eofm virtual-oct --threads {threads} {input.truth} {input.background} --reference {output.reference}"
        " --deformed {output.deformed} --truth {output.truth}"
        " --background {output.background} {params.options} > {log} 2>&1"


rule virtual_oct_track:
    input:
        reference=f"{VIRTUAL}/reference.tif",
        deformed=f"{VIRTUAL}/deformed.tif",
        prediction=f"{VIRTUAL}/background.tif",
        code=code("track"),
    output:
        f"{VIRTUAL}/bubbles.csv",
    log:
        "logs/virtual_oct/track.log",
    benchmark:
        "benchmarks/virtual_oct/track.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=500,
    params:
        # The error of the prediction grows with the sample.
        options=options(
            settings.tracking.changed(
                gate=settings.tracking.gate * settings.virtual_oct.scale
            )
        ),
    shell:
        "eofm track --threads {threads} {input.reference} {input.deformed} --prediction {input.prediction}"
        " --output {output} {params.options} > {log} 2>&1"


rule virtual_oct_estimate:
    input:
        reference=f"{VIRTUAL}/reference.tif",
        deformed=f"{VIRTUAL}/deformed.tif",
        known=lambda wildcards: (
            [f"{VIRTUAL}/bubbles.csv", f"{VIRTUAL}/background.tif"]
            if wildcards.method == "eofm"
            else []
        ),
        code=code("estimate"),
    output:
        f"{VIRTUAL}/{{method}}/displacement.tif",
    log:
        "logs/virtual_oct/{method}.log",
    benchmark:
        "benchmarks/virtual_oct/{method}.tsv"
    wildcard_constraints:
        method="|".join(METHODS),
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=1000,
    params:
        options=lambda wildcards: options(METHODS[wildcards.method]),
        known=lambda wildcards, input: (
            "--bubbles {} --background {}".format(*input.known) if input.known else ""
        ),
    shell:
        "eofm estimate --threads {threads} {input.reference} {input.deformed} {params.known}"
        " --output {output} {params.options} > {log} 2>&1 || [ $? -eq 3 ]"


rule virtual_oct_report:
    input:
        reference=f"{VIRTUAL}/reference.tif",
        deformed=f"{VIRTUAL}/deformed.tif",
        truth=f"{VIRTUAL}/true.tif",
        background=f"{VIRTUAL}/background.tif",
        bubbles=f"{VIRTUAL}/bubbles.csv",
        standard=f"{VIRTUAL}/standard/displacement.tif",
        eofm=f"{VIRTUAL}/eofm/displacement.tif",
        code=code("virtual_oct.py"),
    output:
        errors=report(
            f"{VIRTUAL}/errors.csv",
            caption="../report/virtual_oct.rst",
            category="Virtual OCT",
        ),
        figure1=report(
            f"{VIRTUAL}/figures/figure1.png",
            caption="../report/figure1.rst",
            category="Virtual OCT",
        ),
        figure2=report(
            f"{VIRTUAL}/figures/figure2.png",
            caption="../report/figure2.rst",
            category="Virtual OCT",
        ),
        figure8=report(
            f"{VIRTUAL}/figures/figure8.png",
            caption="../report/figure8.rst",
            category="Virtual OCT",
        ),
        pdf=expand(
            "{folder}/figures/figure{number}.pdf", folder=VIRTUAL, number=[1, 2, 8]
        ),
    log:
        "logs/virtual_oct/report.log",
    benchmark:
        "benchmarks/virtual_oct/report.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=500,
    params:
        figures=settings.figures.model_dump()
        | {"pixel_size": 2 * [settings.virtual_oct.pixel_size]},
    script:
        "../scripts/virtual_oct.py"
