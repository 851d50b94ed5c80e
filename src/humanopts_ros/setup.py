from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = 'humanopts_ros'
MANIFEST = ElementTree.parse('package.xml')

setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description=MANIFEST.findtext('description'),
    long_description=Path('README.md').read_text('utf-8'),
    long_description_content_type='text/markdown',
    license=MANIFEST.findtext('license'),
    install_requires=[
        'numpy>=1.26.4',
        'psutil>=5.9.8',
        'pydantic>=2.7',
        'pyyaml>=6.0.1',
    ],
    python_requires='>=3.11',
    packages=find_packages(exclude=['test']),
    package_data={NAME: ['py.typed', '*.xml', 'foreign_variables.txt']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
)
