"""The simulated sample: true and background field, images before and after compression."""


rule true_field:
    input:
        code=code("forward"),
    output:
        "results/phantom/true.tif",
    log:
        "logs/true_field.log",
    benchmark:
        "benchmarks/true_field.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("forward", settings.sample.shape),
    params:
        options=options(settings.sample, settings.forward),
    shell:
        "eofm forward --threads {threads} --output {output} {params.options} > {log} 2>&1"


rule background_field:
    input:
        code=code("background"),
    output:
        "results/phantom/background.tif",
    log:
        "logs/background_field.log",
    benchmark:
        "benchmarks/background_field.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("background", settings.sample.shape),
    params:
        options=options(settings.sample, settings.forward),
    shell:
        "eofm background --threads {threads} --output {output} {params.options} > {log} 2>&1"


rule phantom:
    input:
        displacement="results/phantom/true.tif",
        code=code("phantom"),
    output:
        reference="results/phantom/reference.tif",
        deformed="results/phantom/deformed.tif",
        table="results/phantom/bubbles.csv",
    log:
        "logs/phantom.log",
    benchmark:
        "benchmarks/phantom.tsv"
    conda:
        "../envs/eofm.yaml"
    resources:
        mem_mb=step_memory("phantom", settings.sample.shape),
    params:
        options=options(settings.phantom),
    shell:
        "eofm phantom --threads {threads} {input.displacement} --reference {output.reference}"
        " --deformed {output.deformed} --table {output.table} {params.options} > {log} 2>&1"
