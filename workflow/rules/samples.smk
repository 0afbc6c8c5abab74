"""Your own image pairs, one row of the table of samples each."""


rule samples:
    input:
        expand("results/samples/{sample}/summary.json", sample=SAMPLES),


rule sample:
    input:
        files=lambda wildcards: sample_files(SAMPLES[wildcards.sample]),
        code=code("sample"),
    output:
        displacement="results/samples/{sample}/displacement.tif",
        displacement_um="results/samples/{sample}/displacement_um.tif",
        strain="results/samples/{sample}/strain.tif",
        bubbles="results/samples/{sample}/bubbles.csv",
        summary=report(
            "results/samples/{sample}/summary.json",
            caption="../report/sample_summary.rst",
            category="Samples",
            subcategory="{sample}",
            labels={"result": "summary"},
        ),
        pair=sample_figure("pair"),
        fields=sample_figure("displacement"),
        strains=sample_figure("strain"),
        quality=sample_figure("quality"),
    log:
        "logs/samples/{sample}.log",
    benchmark:
        "benchmarks/samples/{sample}.tsv"
    wildcard_constraints:
        sample="|".join(map(re.escape, SAMPLES)) or "none",
    resources:
        mem_mb=4000,
    params:
        options=lambda wildcards: sample_options(SAMPLES[wildcards.sample]),
        folder=lambda wildcards, output: Path(output.summary).parent,
    shell:
        "eofm sample --threads {threads} --folder {params.folder} {params.options} > {log} 2>&1 || [ $? -eq 3 ]"
